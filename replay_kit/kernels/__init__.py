"""The maths of the flow's representation: the incompressible kernel in the horizontal, functions of depth."""
