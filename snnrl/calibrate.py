"""Fit the free values; see `snnrl.thesis.calibrate`."""

import torch

from snnrl.thesis.calibrate import main

if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
