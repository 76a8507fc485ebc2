"""Training the segmentation network: pictures, loss, scores and training loop."""
