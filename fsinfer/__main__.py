"""``python -m fsinfer`` is ``fsinfer``."""

from fsinfer.cli.app import main

if __name__ == "__main__":
    main()
