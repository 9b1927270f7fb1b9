"""The material stage: what is an object made of, judged by how it moves in clips.

probe   the experiment: a coarse copy dropped before one camera
case    one object's experiment, candidates, regions and prior
scan    every combination of laws and stiffness, forward only
descent the training loop, for any model of a field
verdict how good the field is, and the field of the film
"""
