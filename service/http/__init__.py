"""What every request and answer passes, and errors as problem documents."""
