"""Drafts of projects from the images and tables that are there."""
