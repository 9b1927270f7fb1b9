"""Rivals of ``FitMaterial``: other ways of finding the material, on the same engine, object, prior and loop.

A rival is what its paper and its published program do, as far as they differ from ours: which numbers are free, what
they are compared with, and which way they are moved. ``conf/method`` has one preset for each; ``docs/methods.md`` says
what each reproduces and what differs.
"""
