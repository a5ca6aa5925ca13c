"""Plans on an estimate: the planners behind the protocol that a replay calls, and the mission that ``plan`` makes.

``adapters`` binds glides and missions to ``[planner]``; ``inputs`` reads estimates, no-go areas and the depth of the bottom; ``request`` is
what a mission is asked for, checked; ``currents`` what is known of the current at its times; ``mission`` plans it and
flies it through samples of the estimate; ``outputs`` writes it.
"""
