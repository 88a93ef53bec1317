"""Several computers: the workers of a Dask scheduler, and files to and from them."""
