"""Fit the free values; see `snnrl.thesis.calibrate`."""

from snnrl.extras import demand

demand("snnrl.calibrate", "calibration")

from snnrl.thesis.calibrate import main  # noqa: E402

if __name__ == "__main__":
    main()
