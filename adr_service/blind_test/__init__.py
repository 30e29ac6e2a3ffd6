"""Blind tests of methods that name what a simulator lacks.

    hidden, case = draw_blind("arm", rng)       # what is hidden, and the measurement that hides it
    write_question(folder, case)                # all that a method may see
    lines = score([Marked(hidden, answer)])     # shares of right answers, with intervals

`planting` simulates robots that have effects of the catalogue, or those of `outside`, as strong as
`sizing` makes them, and `cases` draws them. `files` is the format in which others get the cases and
hand in their answers, and `scoring` compares these with the key.
"""
