"""The front door: one module a subcommand. Options in, one call of ``pipelines``, results out."""
