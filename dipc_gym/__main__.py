"""`python -m dipc_gym` is `dipc-gym`."""

import sys

from dipc_gym.cli import main

if __name__ == "__main__":
    sys.exit(main())
