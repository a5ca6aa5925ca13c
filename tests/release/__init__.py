"""What a release needs: the licences of what the project depends on, and the reference of its functions as a page."""
