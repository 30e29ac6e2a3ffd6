"""The pages: rendered on the server, with a little script for what changes and sorts."""

from api.page import benchmarks, costs, lists, overview, runs, session, submit

routers = [family.router for family in (overview, benchmarks, runs, costs, submit, lists, session)]
