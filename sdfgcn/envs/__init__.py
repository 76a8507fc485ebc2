"""The TorchRL environment that ties simulation and perception together."""
