"""Planning while a print turns: a process of its own sees what was shown and estimates and plans the turns to come."""
