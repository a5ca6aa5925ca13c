"""Many missions: a table in, a result for each and one table and page over all out; on the processes of one machine or of a cluster."""
