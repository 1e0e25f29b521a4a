"""What is seen of trajectories, observations, rigs and results in a notebook: texts, HTML, pictures, tables, plots.

fgpose.shown is the door: the methods of the classes themselves.
"""
