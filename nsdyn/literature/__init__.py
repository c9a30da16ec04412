"""Methods, formulations and acceleration problems from papers, kept for comparison."""
