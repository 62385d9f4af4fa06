"""Studies of the methods: questions answered by measuring on data sets, with table and figure."""
