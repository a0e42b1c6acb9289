"""What the commands are made of besides the parts they call: answers as text, files, the contents of a ledger. Nothing here prints."""
