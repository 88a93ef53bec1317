"""``python -m fsinfer`` is ``fsinfer``."""

from fsinfer.cli import main

if __name__ == "__main__":
    main()
