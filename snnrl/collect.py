"""Merge runs into one table; see `snnrl.running.merge`."""

from snnrl.extras import demand

if __name__ == "__main__":
    demand("snnrl.collect", "statistics")
    from snnrl.running.merge import main

    main()
