"""What a search comes to: what is named, how sure it is, and what is written back.

In this order: `conclude` strikes off what later data speak against, `last_choice` fits once more, and `judgement` asks
the rest: `measure` for errors and intervals, `word` for the verdict, `findings` and `sentences` for what is said of it,
`improve` for the file. `withheld` keeps test data from all that comes before.
"""
