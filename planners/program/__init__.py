"""The optimal-control program of a mission: its starts, graph, walls and rounds."""
