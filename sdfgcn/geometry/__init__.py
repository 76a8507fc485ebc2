"""Where things are: the camera and the regions of the table."""
