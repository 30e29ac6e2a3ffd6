"""Baselines of criticism: how well others' methods name what a simulator lacks.

    python -m benchmarks.baselines.comparison --cases 60 --task arm --seed 31

Each file has one method; `fitting` and `terms` have what they share. All of them get the same
questions as ours (`adr criticise-bench make`), and our catalogue of effects, which a user of them
would have to write first. They suit the arm: whole episodes in open loop, and forces by the mass
matrix, are for robots without contacts.
"""
