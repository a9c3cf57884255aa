"""A long drive through one town in one go: does memory or time grow with it?"""
