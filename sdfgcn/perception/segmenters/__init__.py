"""Segmenters, from RGB images to object masks (`segmentation=NAME`).

A segmenter is constructed from its config and called with an image, uint8 [H, W, 3]. It returns
disjoint masks, bool [m, H, W], without the background and in any order; m may be 0. It is
deterministic.
"""
