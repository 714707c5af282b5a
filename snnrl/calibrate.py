"""Fit the free values; see `snnrl.thesis.calibrate`."""

from snnrl.thesis.calibrate import main

if __name__ == "__main__":
    main()
