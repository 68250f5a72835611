"""The ground floor: what a test, an alarm, a check, a schedule, an outcome is. No database, no web, no settings."""
