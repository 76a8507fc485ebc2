"""The command `sdfgcn` from a checkout: `python run.py --help` lists what can be set."""

from sdfgcn.cli import main

if __name__ == "__main__":
    main()
