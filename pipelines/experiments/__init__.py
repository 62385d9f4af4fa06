"""Studies: questions about the methods, answered by measurements on data sets."""
