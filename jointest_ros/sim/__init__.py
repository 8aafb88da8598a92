"""Robots and sensors that do not exist: motions, sensor errors and the rigs of the papers, with their ground truth."""
