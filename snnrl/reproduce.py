"""The whole thesis from one command; see `snnrl.thesis.reproduce`."""

from snnrl.extras import demand

if __name__ == "__main__":
    demand("snnrl.reproduce", "thesis")
    from snnrl.thesis.reproduce import main

    main()
