"""Planning and judging of many jobs, in processes or on a cluster, with stored results."""
