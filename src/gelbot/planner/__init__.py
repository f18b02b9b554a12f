"""Which voltages make the gel do what is wanted: search over programmes, with the scatter inside the objective."""
