"""Many plots: each in a process of its own, on this computer or on a Dask cluster, and one summary over all of them."""
