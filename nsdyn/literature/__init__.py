"""Methods, formulations and accelerations of the papers, kept to compare."""
