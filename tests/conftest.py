import torch

torch.set_num_threads(1)  # tensors are small; threads that wait for one another cost a hundredfold on a busy machine
