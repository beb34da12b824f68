"""The report of an identification: one page of HTML, with its pictures in it."""
