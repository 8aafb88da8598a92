"""The joint model: the readings themselves as measurements of the motion of both links, with biases."""
