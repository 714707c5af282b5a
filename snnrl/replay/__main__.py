"""`python -m snnrl.replay`."""

from snnrl.extras import demand

demand("snnrl.replay", "figures")

from snnrl.replay.replay import main  # noqa: E402

if __name__ == "__main__":
    main()
