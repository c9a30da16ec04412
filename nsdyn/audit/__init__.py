"""Audit of a recording: check its motion by code that is independent of the stepper, and give a verdict."""
