"""The frictional contact problem: its statement, formulations and certificate, and its files."""
