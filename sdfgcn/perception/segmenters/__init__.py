"""Segmenters: from an RGB picture to object masks, by `segmentation=` in the config.

A segmenter is made from its config and called with a picture [H, W, 3] uint8; it returns disjoint
masks [m, H, W] bool without the background, in any order, m = 0 included. The same picture gives
the same masks.
"""
