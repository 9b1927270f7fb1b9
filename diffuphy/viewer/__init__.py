"""A finished run in a browser: play it, look at it by stress or by stiffness, change it and simulate it again, pull at
it while it runs; and a run that is being trained, while it is.

    opened.py     a run folder as objects
    change.py     what of it is to be otherwise, and the scene that follows
    shot.py       what is played: particles in motion, the Gaussians that they carry, colours
    player.py     when which frame is shown
    job.py        work in the background that can be stopped
    hand.py       the force of a hand, as drives of the solver
    live.py       a simulation that runs on and on
    session.py    all of these together: what one can do, without a browser
    page.py       the widgets of the browser (viser)
    training.py   what a training stage has so far
"""
