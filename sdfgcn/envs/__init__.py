"""The TorchRL env that combines world and perception."""
