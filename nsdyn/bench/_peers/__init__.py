"""Scripts of nsdyn and its peers that `nsdyn.bench.profiles` and `nsdyn.bench.engines` run in separate processes."""
