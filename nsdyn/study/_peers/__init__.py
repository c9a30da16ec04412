"""Scripts that `nsdyn.study.profile` and `nsdyn.study.bench` run in processes of their own: ours, and the peers."""
