"""The whole thesis from one command; see `snnrl.thesis.reproduce`."""

import torch

from snnrl.thesis.reproduce import main

if __name__ == "__main__":
    with torch.no_grad():
        main()
