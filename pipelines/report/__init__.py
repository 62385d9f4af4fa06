"""Floor 6: figures and a page that show how a run went, from the finished files alone."""
