"""Fit the free values; see `snnrl.thesis.calibrate`."""

from snnrl.extras import demand

if __name__ == "__main__":
    demand("snnrl.calibrate", "calibration")
    from snnrl.thesis.calibrate import main

    main()
