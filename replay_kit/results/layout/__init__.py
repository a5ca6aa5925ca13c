"""How a viewer shows a result: a layout file with every panel set up."""
