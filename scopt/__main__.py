"""``python -m scopt``: the command line of the same name."""

import importlib

if __name__ == "__main__":
    importlib.import_module("service.cli").main()  # the optimiser itself knows nothing of it
