"""Many jobs planned and judged, in processes or on a cluster; answered from a store where nothing has changed."""
