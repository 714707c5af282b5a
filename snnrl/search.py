"""Search the parameters of STDP; see `snnrl.thesis.search`."""

from snnrl.extras import demand

if __name__ == "__main__":
    demand("snnrl.search", "calibration")
    from snnrl.thesis.search import main

    main()
