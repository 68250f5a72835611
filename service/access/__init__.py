"""Who may do what: principals, users, sessions and machine tokens."""
