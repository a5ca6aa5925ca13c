"""Plans on an estimate: the planners behind the protocol of a replay, and the mission of ``plan``.

``request`` checks the request and reads its files; ``currents`` gives the current at the mission's times; ``run`` plans missions and
simulates flights in samples of the estimate; ``outputs`` writes them; ``adapters`` binds glides and missions to ``[planner]``.
"""
