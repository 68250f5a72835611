"""The valve as physics and as data: what every other room speaks of. No wire, no clock, no thread."""
