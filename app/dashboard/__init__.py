"""The dashboard: server, page, and export of pictures. Only this package of `app` imports viser."""
