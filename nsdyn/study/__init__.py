"""Studies: sweeps over parameters, speed against error, profiles of solvers, and the peers."""
