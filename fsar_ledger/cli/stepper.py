"""The screen of `step`: the events around the current one, its record, and the situation after it.

Text from a ledger is escaped first, and passed on as plain text, never as markup.
"""

from typing import ClassVar

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.content import Content
from textual.widgets import Footer, Input, Static

from fsar_ledger.api.state import Steps, standing_lines
from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError

AROUND = 200
"""Events that are listed before and after the current one."""
ASKS = {"next-of": "robot, such as B1", "go": "time or event, such as 46.6s or 289", "find": "text"}
"""The moves that need an argument, and the prompt for it."""


class Stepper(App[None]):
    """A walk through a run by keys."""

    CSS = """
    #events { width: 3fr; }
    #list { text-wrap: nowrap; text-overflow: ellipsis; }
    #beside { width: 2fr; border-left: solid $primary; padding: 0 1; }
    #asked { display: none; dock: bottom; }
    #asked.shown { display: block; }
    #said { height: 1; color: $warning; }
    """
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None  # else the field takes the letters
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right,down,n", "move('next')", "next", priority=True),  # else it scrolls
        Binding("left,up,p", "move('previous')", "back", priority=True),
        Binding("d", "move('next-decision')", "decision"),
        Binding("D", "move('previous-decision')", "previous decision", show=False),
        Binding("r", "move('next-refusal')", "refusal"),
        Binding("c", "move('cause')", "cause"),
        Binding("b", "ask('next-of')", "robot"),
        Binding("g", "ask('go')", "go"),
        Binding("slash", "ask('find')", "find"),
        Binding("home", "move('first')", "first", show=False),
        Binding("end", "move('last')", "last", show=False),
        Binding("q", "quit", "quit"),
    ]

    def __init__(self, steps: Steps, title: str) -> None:
        super().__init__()
        self.steps = steps
        self.title = title
        self._asking = ""
        self._about = dict.fromkeys(ASKS, "")

    def compose(self) -> ComposeResult:
        """Lay out the screen."""
        yield Static(Content(self.title or ""), id="name")
        with Horizontal():
            with VerticalScroll(id="events", can_focus=False):
                yield Static(id="list")
            with VerticalScroll(id="beside", can_focus=False):
                yield Static(id="event")
                yield Static(id="state")
        yield Static(id="said")
        yield Input(id="asked")
        yield Footer()

    def on_mount(self) -> None:
        """Show the first event."""
        self._show("")

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:  # noqa: ARG002 - the name is textual's
        """Leave the keys to the input field while it is shown."""
        is_asking = self.is_running and self.query_one("#asked", Input).has_class("shown")
        return not (is_asking and action in ("move", "ask", "quit"))

    def action_move(self, name: str) -> None:
        """Make a move that needs no argument."""
        self._show(self.steps.move(name) or "")

    def action_ask(self, name: str) -> None:
        """Prompt for the argument of a move; an empty answer repeats the last one."""
        self._asking = name
        field = self.query_one("#asked", Input)
        field.placeholder, field.value = ASKS[name], ""
        field.add_class("shown")
        field.focus()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Make the move whose argument was entered."""
        name, about = self._asking, event.value.strip()
        self._about[name] = about or self._about[name]
        event.input.remove_class("shown")
        self.set_focus(None)
        try:
            message = self.steps.move(name, self._about[name])
        except UsageError as error:
            message = str(error)
        self._show(message or "")

    def _show(self, message: str) -> None:
        steps = self.steps
        first, last = max(0, steps.seq - AROUND), min(steps.size, steps.seq + AROUND)
        lines = []
        for seq in range(first, last):
            mark, style = (">", "reverse") if seq == steps.seq else (" ", "")
            words = printable.value(steps.words[seq], 500)
            lines.append(Content.styled(f"{mark}{seq:>6} {steps.time_s(seq):>10.3f} s  {words}", style))
        self.query_one("#list", Static).update(Content("\n").join(lines))
        fields = [f"{name} = {printable.value(str(value), 500)}" for name, value in steps.fields() if value is not None]
        self.query_one("#event", Static).update(Content("\n".join(fields)))
        self.query_one("#state", Static).update(Content("\n".join(standing_lines(steps.standing()))))
        self.query_one("#said", Static).update(Content(printable.escaped(message)))
        events = self.query_one("#events", VerticalScroll)
        events.scroll_to(y=max(0, steps.seq - first - events.size.height // 2), animate=False)
