"""Audit of a recording: its motion by methods of its own, and a verdict."""
