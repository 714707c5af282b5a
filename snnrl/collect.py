"""Merge runs into one table; see `snnrl.running.merge`."""

from snnrl.extras import demand

demand("snnrl.collect", "statistics")

from snnrl.running.merge import main  # noqa: E402

if __name__ == "__main__":
    main()
