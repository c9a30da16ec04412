"""Frictional contact problem: its statement, its factors, its certificate, and the result of a solver."""
