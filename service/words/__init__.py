"""Words, numbers, units and instants as people read them. Below everything else."""
