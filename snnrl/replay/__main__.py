"""`python -m snnrl.replay`."""

from snnrl.extras import demand

if __name__ == "__main__":
    demand("snnrl.replay", "figures")
    from snnrl.replay.replay import main

    main()
