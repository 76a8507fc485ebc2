"""From a picture to masks, signed distance fields and positions."""
