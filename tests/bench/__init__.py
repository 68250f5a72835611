"""Programs beside the tests: make bench, blind, faults and compose-check. Each has tests of its own."""
