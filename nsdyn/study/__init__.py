"""Studies: sweeps over parameters, refinement in time, comparison of recordings."""
