"""Scripts that `nsdyn.profile` and `nsdyn.bench` run in processes of their own: ours, and the peers to compare with."""
