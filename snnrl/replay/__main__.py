"""`python -m snnrl.replay`."""

from snnrl.replay.replay import main

if __name__ == "__main__":
    main()
