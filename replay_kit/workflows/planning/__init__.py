"""Plans on an estimate: the planners behind the protocol of a replay, and the mission of ``plan``.

``adapters`` binds glides and missions to ``[planner]``; ``inputs`` reads estimates, no-go areas and bathymetry; ``request`` checks the
request; ``currents`` gives the current at the mission's times; ``run`` plans missions and simulates flights in samples of the estimate;
``outputs`` writes them.
"""
