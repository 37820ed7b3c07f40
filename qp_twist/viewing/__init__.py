"""The live page: robot, workpiece and path in a browser, played, dragged and varied."""
