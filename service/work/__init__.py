"""What the processes behind a server do: each kind of work is a function of data, told to stop by a ``Control``."""
