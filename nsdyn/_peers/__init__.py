"""Scripts that `nsdyn.profile` runs in processes of their own: our solvers, and the peers to compare with."""
