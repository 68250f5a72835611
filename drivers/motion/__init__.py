"""The program that moves valves.

It owns the buses, the journal of each test and the audit log's intent, and knows no web and no database.
"""
