"""Search the parameters of STDP; see `snnrl.thesis.search`."""

from snnrl.thesis.search import main

if __name__ == "__main__":
    main()
