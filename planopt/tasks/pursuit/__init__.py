"""The task pursuit: pursuers that know evaders through aged, coarse snapshots, simulated."""
