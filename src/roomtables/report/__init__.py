"""Results for people: pictures, and one page that holds everything."""
