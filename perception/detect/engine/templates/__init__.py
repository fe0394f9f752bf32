"""Templates, one module of data per kind of object."""
