"""Planning of taking an object and putting it elsewhere."""
