"""Search the parameters of STDP; see `snnrl.thesis.search`."""

from snnrl.extras import demand

demand("snnrl.search", "calibration")

from snnrl.thesis.search import main  # noqa: E402

if __name__ == "__main__":
    main()
