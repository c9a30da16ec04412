"""Contacts of a configuration: which shapes touch, where, and how far apart they are."""
