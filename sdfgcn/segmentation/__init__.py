"""Training the segmentation network: its pictures, its loss, its scores, the loop."""
