"""Valves over the REST interface."""
