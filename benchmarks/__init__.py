"""Measurements as ratios; run the files of this folder as scripts."""
