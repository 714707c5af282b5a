"""Merge runs into one table; see `snnrl.running.merge`."""

from snnrl.running.merge import main

if __name__ == "__main__":
    main()
