from pathlib import Path
import sys
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'humanopts_learner'
MANIFEST = ElementTree.parse('package.xml')
# Executables of ros2 run, which is not there where wheels are installed.
NODES = [
    'learner = humanopts_learner.ros.learner_node:main',
    'option_server = humanopts_learner.ros.option_server:main',
    'planner = humanopts_learner.ros.planner_node:main',
]
SCRIPTS = [] if 'bdist_wheel' in sys.argv else NODES

setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=MANIFEST.findtext('description'),
    long_description=Path('README.md').read_text('utf-8'),
    long_description_content_type='text/markdown',
    license=MANIFEST.findtext('license'),
    install_requires=[
        'humanopts-env',
        'humanopts-ros',
        'lazy-loader>=0.3',
        'numpy>=1.26.4',
        'pydantic>=2.7',
        'scikit-learn>=1.4.1',
        'scipy>=1.11.4',
    ],
    python_requires='>=3.11',
    packages=find_packages(exclude=['test']),
    package_data={NAME: ['py.typed', '__init__.pyi']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    extras_require={
        'numba': ['numba'],  # faster planning with many states
        'tables': ['pandas>=2.1.4'],  # demonstrations from data frames, and files for spreadsheets
    },
    entry_points={
        'console_scripts': SCRIPTS,
    },
)
