"""``python -m qp_twist``: the command ``qp-twist``."""

from qp_twist.cli import main

if __name__ == "__main__":
    main()
