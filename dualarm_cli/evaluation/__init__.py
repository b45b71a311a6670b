"""Planning and judging of many jobs in processes or on a cluster.

Results are stored.
"""
