"""The terms of the objective: each module one term, a value and its Gauss-Newton system (HY 2.3).

`correspondence.objective` lists and sums them.
"""
