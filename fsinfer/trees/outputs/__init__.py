"""Tables, maps, figures and labelled points of measured trees."""
