"""Extended models that somebody accepted for a valve: later tests are judged against them."""
