"""Segmenters, from RGB pictures to object masks (`segmentation=NAME`).

A segmenter is constructed from its config and called with a picture, uint8 [H, W, 3]. It returns
disjoint masks, bool [m, H, W], without the background and in any order; m may be 0. It is
deterministic.
"""
