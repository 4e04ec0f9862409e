"""``python -m skincal``."""

from skincal.cli.main import main

main()
