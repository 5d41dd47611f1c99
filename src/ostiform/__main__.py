"""``python -m ostiform``."""

from ostiform.cli import main

main()
