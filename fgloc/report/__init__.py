"""Tables, figures and the folder that a run writes into."""
