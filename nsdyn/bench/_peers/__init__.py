"""Scripts that `nsdyn.bench.profiles` and `nsdyn.bench.engines` run in processes of their own: ours, and the peers."""
