"""The report of a study: a self-contained HTML file made from the tables."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import time

from humanopts_teach.bags.provenance import OWN_VERSION, software
from humanopts_teach.report.pages import counted, Finding, limits, number, percent, render
from humanopts_teach.study.accuracy import (
    accuracy_table,
    PAPER_DEMONSTRATIONS,
    PAPER_MINUTES,
)
from humanopts_teach.study.export import suggested
from humanopts_teach.study.figures import (
    accuracy_figure,
    outcome_figure,
    pace_figure,
    progress_figure,
)
from humanopts_teach.study.flow import Flow, flow_of
from humanopts_teach.study.model import Effects, effects, ModelError
from humanopts_teach.study.protocol import SHOWN_DIGEST
from humanopts_teach.study.tables import StudyData, tables
import pandas as pd

OUTCOMES = {  # column of the table of conditions: title and unit
    'demonstrations': ('Demonstrations', 'demonstrations'),
    'options_learned': ('Options learned', 'options'),
    'not_here': ('“Not here” answers', 'answers'),
    'teach_minutes': ('Time of teaching', 'min'),
}


@dataclass(frozen=True)
class Section:
    """A section of the report; empty parts are omitted."""

    anchor: str
    title: str
    text: Sequence[str] = ()  # paragraphs
    markup: str = ''  # HTML
    figures: Sequence[tuple[str, str]] = ()  # SVG and caption
    tables: Sequence[tuple[str, pd.DataFrame]] = ()  # caption and table; numbers are right-aligned
    notes: Sequence[str] = ()  # paragraphs after the tables


@dataclass(frozen=True)
class Results:
    """The data of a study and its tables."""

    data: StudyData

    @cached_property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables by name."""
        return tables(self.data)

    @cached_property
    def flow(self) -> Flow:
        """The flow of participants."""
        return flow_of(self.data, self.tables)

    @cached_property
    def conditions(self) -> list[str]:
        """The conditions, in the order of the newest plan that contains them."""
        plans = reversed(self.data.protocol.versions)
        planned = dict.fromkeys(each.name for v in plans for each in v.plan.conditions)
        return list(planned) or list(self.tables['conditions']['condition'].unique())

    @cached_property
    def has_people(self) -> bool:
        """Whether there are participants other than simulated ones."""
        return bool((self.tables['participants']['simulated'] == 'no').any())

    def analysed(self, table: str) -> pd.DataFrame:
        """Return the rows of the analysed participants in a table."""
        people = self.tables['participants']
        kept = people[people['state'] != 'excluded']
        if self.has_people:
            kept = kept[kept['simulated'] == 'no']
        rows = self.tables[table]
        return rows[rows['participant'].isin(kept['participant'])]

    @cached_property
    def taught(self) -> pd.DataFrame:
        """One row for each analysed participant who began to teach in a condition."""
        rows = self.analysed('conditions')
        rows = rows[rows['reached'] == 'yes']
        return rows.assign(teach_minutes=rows['teach_seconds'] / 60)


def study_report(data: StudyData) -> str:
    """Return the HTML report of a study with at least one participant."""
    results = Results(data)
    sections = [found for section in SECTIONS if (found := section(results)) is not None]
    versions = data.protocol.versions
    name = versions[-1].plan.study if versions else data.records[0].path.parent.name
    now = software()
    values = {
        'title': f'{name}: report of the study',
        'findings': list(_findings(results)),
        'sections': sections,
        'simulated': not results.has_people,
        'cell': _cell,
        'provenance': {
            'study': name,
            'plan': ', '.join(version.digest[:SHOWN_DIGEST] for version in versions) or 'unknown',
            'seed': str(versions[-1].plan.seed) if versions else 'unknown',
            'data of': time.strftime('%Y-%m-%d %H:%M', time.localtime(data.now)),
            'humanopts': now[OWN_VERSION],
        },
    }
    return render('humanopts_teach.study', 'report.html', values)


def _cell(value: object) -> str:
    """Format a value of a table."""
    return number(value, 3) if isinstance(value, float) else str(value)


def _findings(results: Results) -> Iterator[Finding]:
    """Yield sentences on the flow of participants and the effects."""
    flow = results.flow
    parts = [f'{counted(flow.began, "participant")} began', f'{flow.finished} finished']
    for count, word in (
        (flow.declined, 'declined'),
        (flow.excluded, 'failed too many attention checks'),
        (flow.withdrawn, 'withdrew'),
        (flow.dropped_out, 'dropped out'),
        (flow.under_way, 'are under way'),
    ):
        parts += [f'{count} {word}'] if count else []
    yield Finding(None, f'{", ".join(parts[:-1])} and {parts[-1]}.')
    for outcome in ('demonstrations', 'options_learned'):
        try:
            found = effects(results.taught, outcome, results.conditions)
        except ModelError:
            continue
        title, unit = OUTCOMES[outcome]
        for row in found.rows:
            shift = row.difference
            size = f'{number(shift.mean, 3)} {unit} {limits(shift, 3)}'
            text = f'{title}: {row.condition} less {row.reference} is {size}'
            if shift.above() is None:
                text += ', so they are not distinguishable'
            yield Finding(None, f'{text}.')


def flow_section(results: Results) -> Section:
    """Return the flow of participants, as in CONSORT (Schulz, Altman and Moher 2010)."""
    people = results.tables['participants']
    orders = people.groupby('order', sort=False)['state'].value_counts().unstack(fill_value=0)
    orders = orders.reset_index().rename_axis(columns=None)
    return Section(
        'flow',
        'Participants',
        markup=render('humanopts_teach.study', 'flow.html', {'flow': results.flow}),
        tables=[('Participants by order of conditions', orders)] if len(orders) > 1 else [],
    )


def curves_section(results: Results) -> Section | None:
    """Return the curves by condition, with one line per person."""
    given = results.analysed('demonstrations')
    given = given[given['withdrawn'] == 'no']
    figures = [
        (
            progress_figure(given, results.analysed('options'), results.conditions),
            'An option counts from its last demonstration if it was learned in the end. The '
            'mean is over all who taught; those who gave fewer demonstrations keep their '
            'last value.',
        ),
        (
            pace_figure(given, results.conditions),
            'From the start state to the verdict. The mean is over those who got that far '
            '(at least two).',
        ),
    ]
    drawn = [each for each in figures if each[0]]
    return Section('curves', 'Learning curves', figures=drawn) if drawn else None


def effect_section(results: Results) -> Section | None:
    """Return the effects of the conditions on each outcome."""
    rows, names = results.taught, results.conditions
    if rows.empty or len(names) < 2:
        return None
    found, remarks = list[dict[str, object]](), dict[str, list[str]]()
    for outcome, (title, unit) in OUTCOMES.items():
        named = f'{title}, {unit}' if unit == 'min' else title
        row, remark = _effect_row(rows, outcome, names)
        found.append({'outcome': named, **row})
        remarks.setdefault(remark, []).append(title)
    text = (
        'Outcomes of participants who began to teach in a condition, zeros included. The model is '
        'a linear mixed model: fixed effects of the condition and of its position in the order, '
        'and a random intercept for each participant. Intervals are not adjusted for the number '
        'of outcomes.'
    )
    figures = [
        (outcome_figure(rows, outcome, *OUTCOMES[outcome], names), '')
        for outcome in ('demonstrations', 'teach_minutes')
    ]
    return Section(
        'effect',
        'Effect of the conditions',
        [text],
        '',
        figures,
        [_framed('', found)],
        _remarks(remarks),
    )


def _framed(caption: str, rows: Sequence[dict[str, object]]) -> tuple[str, pd.DataFrame]:
    return caption, pd.DataFrame(rows).fillna('')


def _remarks(of: Mapping[str, Sequence[str]]) -> list[str]:
    """Return each remark on the models once, with its outcomes."""
    return [f'{", ".join(titles)}: {remark}' for remark, titles in of.items() if remark]


def _effect_row(
    rows: pd.DataFrame, outcome: str, names: Sequence[str]
) -> tuple[dict[str, object], str]:
    """Return means by condition and the differences, and a remark on the model."""
    by = rows.groupby('condition')[outcome]
    row: dict[str, object] = {}
    for name in names:
        if name in by.groups:
            values = by.get_group(name).dropna()
            spread = f' ± {number(float(values.std()), 3)}' if len(values) > 1 else ''
            row[name] = f'{number(float(values.mean()), 3)}{spread} (n = {len(values)})'
    if len(names) < 2:
        return row, ''
    try:
        model: Effects = effects(rows, outcome, names)
    except ModelError as error:
        return row, str(error)
    for effect in model.rows:
        found = effect.difference
        difference = f'{number(found.mean, 3)} {limits(found, 3)}'
        row[f'{effect.condition} less {effect.reference}'] = difference
    return row, model.remark


def buttons_section(results: Results) -> Section | None:
    """Return the buttons that people suggested, as in Table 1 of the paper."""
    found, notes = [], []
    for table in suggested(results.data):
        rows = [
            {
                'button': row.option,
                'people': f'{row.people} of {len(table.people)}',
                'share': percent(row.share),
                '95 % interval': f'{percent(row.share_low)} to {percent(row.share_high)}',
                'paper': percent(row.paper),
                'taught by': row.taught,
            }
            for row in table.rows
        ]
        found.append((table.domain, pd.DataFrame(rows)))
        most = [row.option for row in table.rows if 2 * row.people > len(table.people)]
        if most:
            notes.append(f'{table.domain}: more than half of the people named {", ".join(most)}.')
    text = 'Buttons that people suggested or taught, as in Table 1 of the paper.'
    return Section('buttons', 'Buttons', [text], tables=found, notes=notes) if found else None


def paper_section(results: Results) -> Section | None:
    """Return the accuracy of the options, as in figure 2 of the paper."""
    taught = results.taught
    points = accuracy_table(results.data, {*taught['participant']})
    if points.empty:
        return None
    figures, rows, notes = list[tuple[str, str]](), list[dict[str, object]](), list[str]()
    for domain, own in points.groupby('domain', sort=False):
        for measure, title in (('policy', 'Policy'), ('classification', 'Classification')):
            named = f'{domain}: {title.lower()} accuracy'
            figures.append((accuracy_figure(own, measure, named, PAPER_DEMONSTRATIONS), ''))
        for option, points_of in own.groupby('option', sort=False):
            last = points_of.groupby(['participant', 'condition']).last()
            rows.append(
                {
                    'button': option,
                    'game': domain,
                    'people': points_of['participant'].nunique(),
                    'demonstrations': float(last['demonstrations'].mean()),
                    'policy accuracy': percent(float(last['policy'].mean())),
                    'classification accuracy': percent(float(last['classification'].mean())),
                    'average return': float(last['return'].mean()),
                    'best return': float(last['best_return'].mean()),
                }
            )
        here = taught[taught['condition'].isin(own['condition'])]
        minutes = here.groupby('participant')['teach_minutes'].sum().mean()
        notes.append(
            f'{domain}: teaching took {number(float(minutes), 3)} min on average; the '
            f"paper's participants took no more than {PAPER_MINUTES[str(domain)]:g}."
        )
    text = (
        'Policy accuracy is the share of states in which an option takes one of the best actions, '
        'and classification accuracy the share of states in which it is right about where the '
        'option can start and where it ends, by the reference option of the same name. Thin '
        'lines are individual people. In the paper, both increase with the number of '
        f'demonstrations and are acceptable with over {PAPER_DEMONSTRATIONS} in both games; '
        'classification does not reach 100 %. The paper gives no numbers for its curves.'
    )
    return Section(
        'paper',
        "Accuracy of the buttons, next to the paper's",
        [text],
        figures=figures,
        tables=[_framed('After the last demonstration: means of people', rows)],
        notes=notes,
    )


def times_section(results: Results) -> Section | None:
    """Return the time spent on each kind of part, min."""
    parts = results.analysed('parts')
    ended = parts[parts['why'] != '']
    if ended.empty:
        return None
    minutes = ended.assign(minutes=ended['seconds'] / 60)
    by = ['condition', 'kind']
    person = minutes.groupby([*by, 'participant'], sort=False)['minutes'].sum()
    found = person.groupby(by, sort=False).agg(['count', 'median', 'min', 'max']).reset_index()
    names = {
        'kind': 'part',
        'count': 'people',
    }
    found = found.round(2).rename(columns=names | {'min': 'shortest', 'max': 'longest'})
    people = results.analysed('participants')
    people = people[people['state'] == 'finished']
    text = []
    if len(people):
        active = people['active_seconds'] / 60
        text = [
            f'Those who finished took {active.median():.1f} min (median; {active.min():.1f} to '
            f'{active.max():.1f}) without breaks.'
        ]
    text.append('Minutes at the parts that ended, over all sittings, without breaks.')
    return Section('times', 'Times', text, tables=[('', found)])


def questions_section(results: Results) -> Section | None:
    """Return the answers to questionnaires by condition."""
    answers = results.analysed('answers')
    rated = answers[answers['kind'].isin(['rating', 'number']) & answers['value'].notna()]
    rows, remarks = list[dict[str, object]](), dict[str, list[str]]()
    for item, own in rated.groupby('item', sort=False):
        first = own.iloc[0]
        row, remark = _effect_row(own, 'value', results.conditions)
        if first['kind'] == 'rating':
            ends = f'{first["low"]} (1) to {first["high"]} ({first["points"]:.0f})'
            row['scale'] = ends
        rows.append({'question': first['wording'], **row})
        remarks.setdefault(remark, []).append(str(item))
    tables = [_framed('Means and standard deviations', rows)] if rows else []
    chosen = answers[answers['kind'].isin(['choice', 'choices'])]
    for (_, wording), own in chosen.groupby(['item', 'wording'], sort=False):
        texts = own.assign(answer=own['text'].str.split(' | ', regex=False)).explode('answer')
        counts = texts.groupby(['answer', 'condition'], sort=False).size().unstack(fill_value=0)
        tables.append((str(wording), counts.reset_index().rename_axis(columns=None)))
    notes = _remarks(remarks)
    checks = results.tables['participants'][['checks', 'checks_failed']].sum()
    if checks['checks']:
        notes.append(
            f'{checks["checks_failed"]:.0f} of {checks["checks"]:.0f} attention checks failed.'
        )
    return Section('questions', 'Questionnaires', tables=tables, notes=notes) if tables else None


SECTIONS: tuple[Callable[[Results], Section | None], ...] = (
    flow_section,
    curves_section,
    effect_section,
    buttons_section,
    paper_section,
    times_section,
    questions_section,
)
